"""ROS bags as recordings: pictures, poses of the arm, and which pictures belong to which pose."""
