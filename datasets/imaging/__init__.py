"""Pictures: reading, resampling, undistortion, regions of the sensor."""
