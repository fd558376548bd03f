"""Facts about a source, and the sfr.yaml that is inferred from its topics, frames and stamps."""
