"""Parking, on highway-env's lot and on others: in highway-env and in a vectorized simulator."""
