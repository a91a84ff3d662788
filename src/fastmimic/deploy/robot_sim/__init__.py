"""A simulated robot in its own process, with a real robot's interface, to rehearse with."""
