"""The examples of the dissertation, worked again: its own network, ours, and the bound that no method can pass."""
