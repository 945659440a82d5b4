"""Network definitions in torch, for training; start-up never imports them."""
