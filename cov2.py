import json,sys,pathlib,collections
from calib.challenge.cases import Truth
from calib.challenge.judge import compare
C=collections.defaultdict(list)
for s in sys.argv[1:]:
    T=json.load(open(f'/tmp/trust/{s}.truth.json'))['cases']
    items=T.items() if isinstance(T,dict) else [(c['recipe']['case'],c) for c in T]
    for n,c in items:
        p=pathlib.Path(f'/tmp/trust/{s}/verdicts/{n}.json')
        if not p.exists(): continue
        d=json.load(open(p))
        for name,t,lo,hi in compare(Truth.from_dict(c),d):
            z=(t-(lo+hi)/2)/((hi-lo)/2)*1.96 if hi>lo else 99
            g=c['recipe']['group']; C[(g,)].append(z); C[(name,)].append(z)
for k,v in sorted(C.items()): 
    import numpy as np
    v=np.array(v); print(k,len(v),'cover %.3f'%np.mean(abs(v)<1.96),'rms z %.2f med|z| %.2f mean %.2f'%(np.sqrt(np.mean(np.clip(v,-8,8)**2)),np.median(abs(v)),np.mean(np.clip(v,-8,8))))
