"""Pages: what a browser shows of results and of the catalogue.

effects: the catalogue of effects as Markdown, with formulas and figures. examples: formula and example of each effect.
commands: the commands by group, as Markdown. view: a local page of a folder of results.
"""
