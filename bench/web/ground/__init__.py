"""What every part of the server needs: settings, policy, problems, limits of requests."""
