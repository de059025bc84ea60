"""What several tests need: small runs, synthetic data, stations, servers and browsers."""
