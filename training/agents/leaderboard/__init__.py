"""A leaderboard of drivers on fixed streets with the waveform rig, worn wheels and damaged sonars.

command  score a driver, and print the verified table (`sonar-gym leaderboard`)
tracks   streets, damage and the checksum of all that defines them
rows     the result of a driver in a file, with its checksum; the table
"""
