"""Design, analysis and closed-loop simulation of the camless engine's air-charge controller."""
