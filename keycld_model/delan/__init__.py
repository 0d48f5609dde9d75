"""Deep Lagrangian Networks and their rivals: dynamics of joints, learned from positions, velocities and torques."""
