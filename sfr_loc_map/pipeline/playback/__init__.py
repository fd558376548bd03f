"""A source as a stream of messages, and the controls of its playback."""
