"""The four synthetic actors: faces, action units, performances, captures, all from code."""
