#![allow(missing_docs)]
use scopeservo_scope::*; use scopeservo_twin::*; use std::sync::Arc;
#[test] fn pictures(){
 let mut c=Config::noiseless(); c.optics.retain(|o|o.id.0=="40x"); c.nosepiece.parfocal_um=0.0;
 let lat=|f:&dyn Fn(&mut LatticeConfig)|{let mut l=LatticeConfig::default(); f(&mut l); MadeSpecimen::Lattice(l)};
 let list=vec![
  ("sparse",MadeSpecimen::Sparse(SparseConfig::default())),
  ("hexcells",lat(&|l|{l.kind=LatticeKind::Hexagonal;l.cells=CellKind::Cells;l.pitch_um=40.0;l.fill=0.8;l.disorder=0.05;l.turned_deg=20.0})),
  ("dies",lat(&|l|{l.kind=LatticeKind::Dies;l.pitch_um=90.0;l.fill=0.9;l.numbered=true;l.turned_deg=5.0})),
  ("chequer",lat(&|l|{l.kind=LatticeKind::Chequer;l.pitch_um=20.0;l.fill=1.0;l.turned_deg=10.0})),
  ("holes",lat(&|l|{l.holes=true;l.cells=CellKind::Squares;l.pitch_um=30.0;l.fill=0.7;l.odd_cell=Some([1,1])})),
  ("grating",lat(&|l|{l.kind=LatticeKind::Grating;l.pitch_um=8.0;l.disorder=0.05;l.turned_deg=30.0})),
  ("twice",MadeSpecimen::Twice(TwiceConfig{seed:1,original_um:[-80.0,0.0],copy_um:[80.0,0.0],size_um:[100.0,150.0]})),
 ];
 for (n,m) in list { let mut c=c.clone();
  if n=="sparse" { c.camera.dust=vec![DustConfig{specks:20,radius_px:[2.0,15.0],attenuation:[0.2,0.8],steepness:[2,60],stretch:[1.0,3.0],rings:0.4},DustConfig{specks:3,radius_px:[1.5,2.5],attenuation:[0.3,0.6],steepness:[5,20],stretch:[20.0,40.0],rings:0.0}];
   c.camera.marks=vec![Mark::Text{text:"Sample 20-1147 HE (40x)".into(),at_px:[10,10],dot_px:2,level:0.0,box_level:Some(1.0)},Mark::StagePlace{at_px:[10,455],dot_px:2,level:1.0,box_level:Some(0.0)},Mark::Reticle{centre_px:[320.0,240.0],arm_px:200.0,line_px:1.2,tick_px:15.0,circles_px:vec![100.0],attenuation:0.8}];}
  let t=Twin::new(c,m.make().unwrap(),3,Arc::new(VirtualClock::new())).unwrap();
  let f=t.camera().grab().unwrap(); let Samples::U8(v)=f.samples else {panic!()};
  image::RgbImage::from_raw(640,480,v).unwrap().save(format!("/tmp/pic_{n}.png")).unwrap(); }
}
