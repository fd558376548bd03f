"""Images as arrays, decoded from files and messages, and stereo pairs whose images are files."""
