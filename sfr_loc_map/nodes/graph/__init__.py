"""Observes the running graph: its publishers, why a topic is silent, its services, and its messages in a bag."""
