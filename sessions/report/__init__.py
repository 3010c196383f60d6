"""HTML reports of sessions: one self-contained page, made of stored results only."""
