"""What is seen of CRTK devices on the graph while somebody looks, and what a page may ask of them."""
