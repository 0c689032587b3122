"""Pages: what a browser shows of results and of the catalogue.

effects: the catalogue of effects as Markdown, with formulas and figures. examples: formula and example of each effect.
view: a page of a folder of results.
"""
