"""Network definitions in torch, for training and for batches; start-up never imports them."""
