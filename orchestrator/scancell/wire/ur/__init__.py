"""Interfaces of Universal Robots: RTDE, scripts, dashboard."""
