"""How fast bakes are, as ratios that hold on any machine: `make bench`."""
