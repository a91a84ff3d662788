"""The viewer in the browser: plays back a robot's motion, reference, contacts and forces.

Only scene, panel and viewer need viser, which comes with the extra `view`; its meshes need trimesh.
"""
