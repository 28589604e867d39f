"""Results over 2 GiB; use of each key by the hour; what one server does for all; indices."""

import sqlalchemy as sql
from alembic import op

revision, down_revision = "2", "1"
SAFE = True


def upgrade() -> None:
    """Take the step; integers of SQLite have 64 bits as they are."""
    if op.get_bind().dialect.name != "sqlite":
        op.alter_column("deitalk_jobs", "result_bytes", type_=sql.BigInteger)
    op.create_index("ix_deitalk_jobs_finished", "deitalk_jobs", ["finished"])
    op.create_index("ix_deitalk_jobs_webhook_left", "deitalk_jobs", ["webhook_left"])
    op.create_table(
        "deitalk_usage",
        sql.Column("owner", sql.String(64), primary_key=True),
        sql.Column("hour", sql.Integer, primary_key=True, autoincrement=False),
        sql.Column("seconds", sql.Float, nullable=False),
    )
    op.create_table(
        "deitalk_duties",
        sql.Column("name", sql.String(40), primary_key=True),
        sql.Column("until", sql.Float, nullable=False),
    )
