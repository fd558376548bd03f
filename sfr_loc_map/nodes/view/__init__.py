"""Shows a running graph to the viewers of `live`: a feed of messages and maps, and an operator of services."""
