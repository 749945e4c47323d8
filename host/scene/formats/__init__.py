"""Reads scenes from files: NFF, OBJ, PLY, STL, glTF, and the project's own TOML."""
