"""Results as one HTML page that opens without a network: from their JSON documents alone, computing nothing."""
