"""labnnum: measured frequency responses, updated models, and the physics that a model left out."""

__version__ = "0.1.0"
