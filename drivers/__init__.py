"""Hardware drivers: generators, digitisers, triggers, and their simulated and replayed counterparts."""
