"""What odometry remembers: keyframes and the points that they show, held together."""
