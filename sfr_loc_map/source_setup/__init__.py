"""What a source holds, and the sfr.yaml that its topics, frames and stamps suggest."""
