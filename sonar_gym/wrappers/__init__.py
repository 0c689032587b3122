"""Wrappers that replace the ideal ranges of an environment by sonar readings.

`observation`: the wrappers `SonarObservation` and `SonarVectorObservation`.
`settings`: their settings, and the prior over the conditions of a ping.
`sources`: conditions of the pings from observed ranges, or from the parking street.
`highway`: conditions of the pings from the roads of highway-env.
"""
