"""Unitree's Go2 and its family: their messages, checksum, and services over DDS."""
