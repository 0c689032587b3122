"""Development trials of the diagnosis with causes concealed in recordings of the rig.

__main__  command: python -m benchmarks.diagnosis --trials 100
causes    concealed causes and the effects accepted as their names
trials    one trial: recording and diagnosis
"""
