"""From a recording to a scene: what the sensor saw becomes pictures, and what was on becomes the frame of the light."""
