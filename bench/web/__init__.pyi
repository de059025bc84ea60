from .ground.settings import Settings as Settings
from .live.outcomes import EXIT as EXIT
from .people.people import Role as Role
from .people.people import add_person as add_person
from .people.people import add_pin as add_pin
from .server.serving import Tls as Tls
from .server.serving import serve as serve
