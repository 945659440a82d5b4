"""What all tests share: hypothesis does not judge by the clock, since a busy machine is no defect."""

from hypothesis import settings

settings.register_profile("any_machine", deadline=None)
settings.load_profile("any_machine")
