"""The viewer in the browser: plays back a robot's motion, reference, contacts and forces.

Modules: `take` (an episode or motion, and the marks about it: arrays), `bodies` (meshes and kinematics), `scene`
(viser's objects), `panel` (controls, charts), `web` (port and cameras), `viewer` (playback, the page, one HTML file).

Only scene, panel, web and viewer need viser, which comes with the extra `view`; its meshes need trimesh.
"""
