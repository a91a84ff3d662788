"""The viewer in the browser: plays back a robot's motion, reference, contacts and forces.

Modules: `take` (an episode or motion as arrays), `bodies` (meshes and kinematics), `marks` (contacts, forces, friction
pyramids, foot paths, animal), `player` (playback), `charts`, `scene` (viser's objects), `panel` (controls), `web` (port
and cameras), `viewer` (the page), `recording` (the same as one HTML file).

Only scene, panel, web, viewer and recording need viser, which comes with the extra `view`.
"""
