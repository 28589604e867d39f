"""Steps from one schema of the jobs' tables to the next, in the order of their numbers (Alembic).

Each step leaves the server of the schema before it at work: it adds, and neither renames nor
removes. ``SAFE`` says whether a server may take the step when it starts.
"""
