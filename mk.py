import sys
from tests.export.export_support import source_of
from tests.factories import make_training_set
from split_cli.prediction import table as T
s=make_training_set(seed=3,points=60,length_scale_cells=6.0,noise=0.1)
for p in ('rbcm','table'):
    c=source_of(s,predictor=p,name='car_'+p)
    open('/tmp/predict_cpp/car_%s.c'%p,'w').write(c.source); open('/tmp/predict_cpp/car_%s.h'%p,'w').write(c.header)
