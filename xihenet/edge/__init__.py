"""The edge service: phones send what they have seen, a server answers with the light.

`protocol` reads and writes what travels, `sessions` keeps what each session has seen, `batching` puts requests of all
clients into one inference, `service` ties these together without a network, and `server` puts them on HTTP, with
`requests`, the only file that imports Tornado. `client` is the other end, an `InferenceBackend`. Paper: section 5 and
its figure 7.
"""
