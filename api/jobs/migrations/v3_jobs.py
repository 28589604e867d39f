"""The tables of jobs. Schemas 1 and 2 were those of development and have no steps."""

import sqlalchemy as sql
from alembic import op

revision, down_revision = "3", None
SAFE = True


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "deitalk_jobs",
        sql.Column("id", sql.String(64), primary_key=True),
        sql.Column("owner", sql.String(64), nullable=False, index=True),
        sql.Column("status", sql.String(16), nullable=False, index=True),
        sql.Column("work", sql.Text, nullable=False),
        sql.Column("created", sql.Float, nullable=False, index=True),
        sql.Column("started", sql.Float),
        sql.Column("finished", sql.Float, index=True),
        sql.Column("progress", sql.Float, nullable=False),
        sql.Column("attempts", sql.Integer, nullable=False),
        sql.Column("holder", sql.String(64), nullable=False),
        sql.Column("lease", sql.Float, nullable=False),
        sql.Column("cancel", sql.Integer, nullable=False),
        sql.Column("ends", sql.Integer, nullable=False),
        sql.Column("result", sql.String(200)),
        sql.Column("result_bytes", sql.BigInteger, nullable=False),
        sql.Column("answer", sql.Text),
        sql.Column("error", sql.Text),
        sql.Column("idempotency", sql.String(300), unique=True),
        sql.Column("digest", sql.String(64), nullable=False),
    )
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
