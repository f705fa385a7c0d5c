"""Exceptions that a driver's class may raise, one for each error code of the protocol.

Any other exception is answered with `fault`. The message is shown to the user: one sentence that says what to do.
"""


class DriverError(Exception):
    """Base of all below; `code` is the word in the protocol."""

    code = "fault"


class BadRequest(DriverError):
    """The request cannot be understood. Raised by this package only."""

    code = "bad_request"


class Unsupported(DriverError):
    """There is no such call or device."""

    code = "unsupported"


class OutsideLimits(DriverError):
    """The place, exposure or level is outside what the device can do. Nothing moved."""

    code = "outside_limits"


class NoSuchAxis(DriverError):
    """The stage lacks this axis. Nothing moved."""

    code = "no_such_axis"


class NoSuchObjective(DriverError):
    """The nosepiece lacks this objective. Nothing moved."""

    code = "no_such_objective"


class Busy(DriverError):
    """An earlier move, home or change still runs. Nothing new was begun."""

    code = "busy"


class NotHomed(DriverError):
    """The device does not know where it is until it was homed."""

    code = "not_homed"


class Refused(DriverError):
    """Any other reason not to do it. Nothing moved."""

    code = "refused"


class Fault(DriverError):
    """The device failed."""

    code = "fault"
