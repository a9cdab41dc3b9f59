"""Measured flights of others in which someone changed something on purpose: is it named?"""
