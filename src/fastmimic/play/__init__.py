"""One robot, live: the controller at its rate in a simulation that goes on for as long as one looks, steered by hand.

    course      a motion as seen from its own moving frame, so that it can be sped up, bent and lifted while it runs
    stream      the reference of the moment: courses, modulated, as the tables that the controller reads
    limits      how far each motion may be modulated
    transition  from one motion to another, by stitching
    library     the motions by name, and their transitions, made in the background
    getting_up  getting up after a fall
    world       pushes, friction, payload
    session     all of it; what a script, a test or a page drives
    pacing      real time

Nothing here knows of a browser. What the controller computes is the controller's business: it is given another table.
"""
