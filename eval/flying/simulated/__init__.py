"""A Crazyflie that is not there: MuJoCo's vehicle behind the firmware's rules, a radio and motion capture."""
