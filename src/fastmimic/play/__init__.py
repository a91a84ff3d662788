"""One robot, live: the controller at its rate in an endless simulation, steered by hand."""
