"""The parking environment.

environment: `SonarParking-v0`, one environment.
vector: its vector form.
fleet: n worlds as arrays, behind both.
step_kernel: one step of many worlds, compiled.
street: random streets and the reference path.
vehicle: the car.
prior: conditions of each sonar in the street, for credence given a reading.
world: view of one world.
rendering, drawing: frames.
"""
