"""A simulated Crazyflie: MuJoCo's vehicle behind the firmware's rules, a radio and motion capture."""
