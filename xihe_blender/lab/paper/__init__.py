"""The paper's evaluation, made anew: tables and figures with our rooms, networks and server, beside its own."""
