"""Models of the kinematic state [v_f, alpha_f, alpha_r, delta]: a perceptron, a sparse sum, and both together."""
