"""What the robot knows about itself: contact and base state from IMU, joint encoders and foot force."""
