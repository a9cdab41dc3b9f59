"""A simulated Crazyflie: the MuJoCo vehicle with the firmware's rules, a radio and motion capture."""
