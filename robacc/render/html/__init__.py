"""Results as one HTML page that needs no network, made from their JSON documents without further computation."""
