"""From poses and commands to twists and kinematic states: the paper's EKF and its smoother."""
