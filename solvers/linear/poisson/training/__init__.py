"""Training of the learned pressure solvers. Only this package needs PyTorch."""
