"""One robot, live: the controller at its rate in an endless simulation, steered by hand.

Modules: `live_reference` (motions, modulated, and the transitions between them, as the controller's reference tables),
`world` (pushes, friction, payload, getting up), `session` (all of these, for a script, a test or a page), `page` (real
time, recent past, scene), `live_panel` and `steering.js` (controls).
"""
