"""The episode: the closed loop of robot and controller, its reward, its figures, its log."""
