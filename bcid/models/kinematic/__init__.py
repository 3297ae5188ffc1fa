"""Models of the kinematic state [v_f, alpha_f, alpha_r, delta]: a perceptron, a sparse sum, and both together.

`state` (the state, its step, the twist it gives), `k_mlp` (the perceptron), `k_sindy` (the sparse sum), fitted by
`k_sindy_fit` from the terms of `library` and run by `sparse_sum`, `k_sindy_mlp` (both), `torch_rollout` (rollouts in
torch, for training); `saved_kinematics` and `saved_sparse` (what their files must hold).
"""
