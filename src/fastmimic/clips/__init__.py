"""Keypoint clips: file formats, the catalogue of motions, built-in gaits, and segmentation."""
