"""The decision: named causes, confounded effects, the unexplained residual, and whether the fix is recommended."""
