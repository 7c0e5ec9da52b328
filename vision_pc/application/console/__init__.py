"""What a person at the console is shown: the rig at a glance, alarms with advice, what the camera sees."""
