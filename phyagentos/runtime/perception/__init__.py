"""From what is sensed to what is believed: the port, the pipelines, and the parts that they are made of."""
