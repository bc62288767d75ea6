"""Real measurements that nobody of this project made: fits and predictions by the product's own calls."""
