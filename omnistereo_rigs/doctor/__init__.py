"""What is wrong with this rig, or with its pictures? Measured from the images themselves."""
