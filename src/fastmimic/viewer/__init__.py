"""The viewer in the browser: plays back what a robot does, its reference, its contacts and forces.

    take        one episode or motion as arrays: all that is shown
    bodies      the robot's geometry as meshes, and where its bodies and its centre of mass are
    marks       contacts, forces, friction pyramids, foot paths and the animal, as points and lines
    player      play, pause, speed, cycles
    charts      the gait strip, the table of the legs, and the reward's plot
    scene       all of it as viser objects
    panel       the controls
    web         the port and the cameras
    viewer      the page
    recording   the same as one HTML file

Only scene, panel, web, viewer and recording need viser, which comes with the extra `view`.
"""
