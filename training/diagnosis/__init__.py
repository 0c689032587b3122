"""Commands of the diagnosis and of its validation.

demo        a demonstration from recording to parking
demo_page   film and page of the demonstration
diagnose    diagnosis of one recording
drive       one parking episode
effects     catalogue of effects as Markdown
envelope    sealed description of a concealed effect
figures     figures of a diagnosis
maps        maps of a recording by position
prediction  predictions that figures compare with readings
prove       blind trials
prove_real  diagnoses of real recordings with a hidden column
report      HTML report of a diagnosis
"""
