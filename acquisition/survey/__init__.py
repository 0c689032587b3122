"""Survey plans and the sessions that measure them.

quantities: the quantities that a survey can vary, with their limits.
plan: `SurveyPlan`, `Condition` and the built-in plans.
planfile: plans in TOML files.
apply_settings: settings of a condition applied to the simulated rig.
sources: what a session measures with: the rig, or a driver.
session: `Session`, which measures a plan into a recording and can be resumed.
"""
