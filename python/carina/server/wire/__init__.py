"""Messages of the wire, their codec, and the generator of the client's types."""
