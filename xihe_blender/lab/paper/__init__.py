"""The paper's evaluation, repeated: tables and figures with our rooms, networks and server, beside its own."""
