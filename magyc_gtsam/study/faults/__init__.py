"""How often a method is wrong and trusted when sensors, clocks, surroundings or motion are at fault.

How a fault is made shares no code with how it is found: `signals`, `magnetometer`, `gyroscope`, `surroundings` and
`catalogue` import neither estimators nor detectors.
"""
