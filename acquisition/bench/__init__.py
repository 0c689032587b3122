"""The waveform-level rig."""
