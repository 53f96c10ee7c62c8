"""Images: reading, resampling, undistortion, regions of the sensor."""
