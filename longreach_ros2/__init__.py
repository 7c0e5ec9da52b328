"""The arm in ROS 2: a node that stands where the vision PC stands, or one that watches.

What decides needs no ROS; thin shells over ``rclpy`` carry it, which no other package of ours needs.
"""
