"""Nodes as processes: started, watched and ended."""
