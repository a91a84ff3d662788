"""Keypoint clips: the formats they come in, the catalogue of names, the built-in gaits, cutting."""
