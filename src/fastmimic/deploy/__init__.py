"""The real robot: drivers of its low-level interface, the real-time loop, safety, and a robot to rehearse on."""
