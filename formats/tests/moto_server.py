"""An S3 server for the tests: holds the files of a folder, and lets only its own user in.

Prints the port, an access key and its secret key, then what the client of AWS itself is allowed: to list names below a
key (`lists` or `refuses`; some versions of moto take no signature of a query with a slash), and the status of reading
without keys (200 where anyone may). Runs until its input ends.
"""
import json
import logging
import pathlib
import sys
import urllib.request

import boto3
import botocore
import botocore.config
import botocore.exceptions
from moto.server import ThreadedMotoServer

logging.getLogger("werkzeug").setLevel(logging.ERROR)
server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
server.start()
host, port = server.get_host_and_port()
url = f"http://127.0.0.1:{port}"
keys = dict(endpoint_url=url, region_name="us-east-1", aws_access_key_id="any", aws_secret_access_key="any")
s3 = boto3.client("s3", **keys)
s3.create_bucket(Bucket="volumes")
root = pathlib.Path(sys.argv[1])
for path in sorted(root.rglob("*")):
    if path.is_file():
        s3.put_object(Bucket="volumes", Key=f"of mine/{path.relative_to(root).as_posix()}", Body=path.read_bytes())
iam = boto3.client("iam", **keys)
iam.create_user(UserName="reader")
policy = {"Version": "2012-10-17", "Statement": [{"Effect": "Allow", "Action": "s3:*", "Resource": "*"}]}
iam.put_user_policy(UserName="reader", PolicyName="read", PolicyDocument=json.dumps(policy))
key = iam.create_access_key(UserName="reader")["AccessKey"]
# From now on every request is authenticated, its signature included.
# (A body that says it is a form would be taken apart before moto sees it.)
plain = {"Content-Type": "text/plain"}
urllib.request.urlopen(urllib.request.Request(f"{url}/moto-api/reset-auth", data=b"0", headers=plain, method="POST"))


def status(ask):
    """The status with which the client of AWS is answered."""
    try:
        return ask()["ResponseMetadata"]["HTTPStatusCode"]
    except botocore.exceptions.ClientError as error:
        return error.response["ResponseMetadata"]["HTTPStatusCode"]


keys.update(aws_access_key_id=key["AccessKeyId"], aws_secret_access_key=key["SecretAccessKey"])
reader = boto3.client("s3", **keys)
unsigned = botocore.config.Config(signature_version=botocore.UNSIGNED, retries={"total_max_attempts": 1})
anyone = boto3.client("s3", **keys, config=unsigned)
below = dict(Bucket="volumes", Prefix="of mine/zarr/groups.zarr/", Delimiter="/")
one = dict(Bucket="volumes", Key="of mine/zarr/v3_zstd.zarr/zarr.json")
assert status(lambda: reader.get_object(**one)) == 200
lists = "lists" if status(lambda: reader.list_objects_v2(**below)) == 200 else "refuses"
without = status(lambda: anyone.get_object(**one))
print(port, key["AccessKeyId"], key["SecretAccessKey"], lists, without, flush=True)
sys.stdin.read()
server.stop()
