"""How long decisions of exported C take on emulated processors."""
