"""Side by side with what a user would take instead: same pictures, same run, each in a process of its own."""
