"""How a tool takes units: as external sources of TIA Portal, or as PLCopen XML."""
