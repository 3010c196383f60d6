"""One command of the command line a module; `sessions.cli` lists them."""
