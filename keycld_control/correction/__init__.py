"""The whole loop: a mechanism with concealed physics, explored, diagnosed, and swung up by a corrected agent."""
