"""Models of whole inertial units over temperature: two triads, attitudes, what a plan determines, what is wrong."""
