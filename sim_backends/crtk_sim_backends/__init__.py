"""Simulated devices that speak their real wire protocol, each in its own process.

This package imports neither the core nor any driver: a simulator that shared a driver's codec
would repeat its mistakes.
"""
