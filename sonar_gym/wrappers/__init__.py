"""Wrappers that replace the ideal ranges of an environment by sonar readings.

`observation`: the wrappers `SonarObservation` and `SonarVectorObservation`.
`settings`: their settings, and the prior over the conditions of a ping.
`sources`: paths of the pings from observed ranges.
`highway`: paths of the pings from the roads of highway-env.
"""
