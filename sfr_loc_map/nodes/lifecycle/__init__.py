"""What the three nodes share: lifecycle, endpoints, parameters, quality of service, the worker thread."""
