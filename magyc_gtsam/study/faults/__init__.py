"""The study of how often a method is wrong and trusted when sensors, clocks, surroundings or motion are at fault.

The simulation of a fault shares no code with its detection: `signals`, `magnetometer`, `gyroscope`, `surroundings` and
`catalogue` import neither estimators nor detectors.
"""
