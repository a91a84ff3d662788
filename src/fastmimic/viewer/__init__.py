"""The viewer in the browser: what a robot does, its reference, its contacts and forces, to be played back and scrubbed.

    take        one episode or motion as arrays: all that is shown
    bodies      the robot's geometry as meshes, and where its bodies and its centre of mass are
    marks       contacts, forces, friction pyramids and foot paths as points and lines
    animal      the animal's keypoints, beside the robot
    clock       play, pause, speed, cycles
    charts      the gait strip, the table of the legs, and the reward's plot
    scene       all of it as viser objects; panel: the controls; server: the port and the loop
    play        the page of a live session (`fastmimic.play`): scene, panel, history, steering by keys and gamepad

Only the last two lines need viser, which comes with the extra `view`.
"""
