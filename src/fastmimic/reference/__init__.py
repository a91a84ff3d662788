"""The running reference: what the controller follows, and how it passes from motion to motion."""
