"""Observe the running graph for the doctor, and record its topics into a bag."""
