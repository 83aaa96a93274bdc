"""OpenSCENARIO XML 1.x as a source: its XML, storyboard, scripts and positions, and the motion that follows."""
