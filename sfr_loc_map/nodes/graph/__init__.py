"""Observes the running graph for the doctor, and records its topics into a bag."""
