"""RTDE, the controller's real-time data exchange (port 30004): codec, variable table, stream.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide", protocol versions 1 and 2.
"""
