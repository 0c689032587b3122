"""Where simulation and recording differ: residuals, the scan over regions, and comparison of shared conditions."""
