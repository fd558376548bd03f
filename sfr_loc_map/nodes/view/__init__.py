"""Connect the live page to a running graph: a feed of messages and maps, and an operator that calls services."""
