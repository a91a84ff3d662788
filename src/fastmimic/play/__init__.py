"""One robot, live: the controller at its rate in an endless simulation, steered by hand.

Modules: `live_reference` (motions, modulated, and the transitions between them, as the controller's reference tables),
`getting_up` (after a fall), `world` (pushes, friction, payload), `session` (all of these, for a script, a test or a
page), `pacing` (real time), `page` (the browser).
"""
