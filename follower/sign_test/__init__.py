"""The sign test: which way would the vehicle move, and does the camera see as the settings say."""
