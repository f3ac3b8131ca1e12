"""Keep passwords of database and server URIs out of everything that is stored or shown.

Configs, run directories and stores hold URIs without passwords. A password from the command line is kept in the
environment of this process and of its children only.
"""

import json
import os
import re

VARIABLE = "PARKING_EXP_PASSWORDS"  # JSON: URI without password -> URI with password
# Up to the last @: a password may have one, and spaces. `:5432/path` is a port.
USERINFO = re.compile(r"(://[^:/@?\s]*):(?!\d+(?:[/?][^\s@]*)?(?:\s|$)).*@")
QUERY = re.compile(r"([?&])(?:(?:ssl)?password|passwd)=[^&\s'\"]*(&?)")


def strip_password(text: str) -> str:
    """Return a URI, or a text with URIs, without passwords; user names stay."""
    return QUERY.sub(lambda match: match[1] if match[2] else "", USERINFO.sub(r"\1@", text))


def keep_password(uri: str) -> str:
    """Return a URI without its password, and keep that for `with_password` here and in child processes."""
    stripped = strip_password(uri)
    if stripped != uri:
        os.environ[VARIABLE] = json.dumps({**_kept(), stripped: uri})
    return stripped


def with_password(uri: str) -> str:
    """Return a URI with the password that was passed for it, if any.

    Otherwise the driver looks for one itself: `PGPASSWORD`, `~/.pgpass`, `MLFLOW_TRACKING_PASSWORD`.
    """
    return _kept().get(uri, uri)


def _kept() -> dict[str, str]:
    return json.loads(os.environ.get(VARIABLE, "{}"))
