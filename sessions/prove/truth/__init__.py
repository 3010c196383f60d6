"""Concealed truth: finite elements, physics, excitation and measurement chain that share no code with the tool."""
